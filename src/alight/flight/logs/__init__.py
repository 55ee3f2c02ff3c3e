"""Logs of an autopilot as GPS/INS and IMU: PX4's .ulg, ArduPilot's .bin, and the .tlog of a ground station."""
