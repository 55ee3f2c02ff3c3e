"""The structure-from-motion extended Kalman filter."""
