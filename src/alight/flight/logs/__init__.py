"""An autopilot's logs as GPS/INS and IMU: PX4's .ulg, ArduPilot's .bin, and a ground station's .tlog."""
