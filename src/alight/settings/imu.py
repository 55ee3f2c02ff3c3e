"""Noise of an IMU that a recording states."""

from __future__ import annotations

from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class ImuNoise:
    """Noise that a recording states for its IMU at rest (fields as in imu0/sensor.yaml); None: not stated."""

    gyroscope_noise_density: float | None = None  # rad/s per sqrt(Hz)
    gyroscope_random_walk: float | None = None  # rad/s^2 per sqrt(Hz)
    accelerometer_noise_density: float | None = None  # m/s^2 per sqrt(Hz)
    accelerometer_random_walk: float | None = None  # m/s^3 per sqrt(Hz)

    def stated(self) -> dict[str, float]:
        """The stated numbers, by field."""
        return {k: v for k, v in asdict(self).items() if v is not None}

    def in_flight(self, margin: float) -> dict[str, float]:
        """Noise by key of the filter: `margin` times the stated number; numbers that are not above zero are ignored."""
        stated = {
            "gyro_noise": self.gyroscope_noise_density,
            "gyro_walk": self.gyroscope_random_walk,
            "accelerometer_noise": self.accelerometer_noise_density,
            "accelerometer_walk": self.accelerometer_random_walk,
        }
        return {key: margin * value for key, value in stated.items() if value is not None and value > 0.0}
