"""Bags of ROS 1 and ROS 2 as a source: linear reading, choice of topics, streams as those of a flight log."""
