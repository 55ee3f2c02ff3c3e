"""Tuning of the filter and its smoother, and of the bundle adjustment of photos."""

from __future__ import annotations

from pydantic import Field

from alight.settings.base import Fraction, FrozenModel, NonNegative, Positive


class FilterTuning(FrozenModel):
    """Constants of the structure-from-motion filter and of the smoother of recorded flights."""

    points: int = Field(40, ge=4, description="Landmarks held in the state")
    clones: int = Field(8, ge=3, description="Clones held in the state: poses of exposures that are far enough apart")
    pixel_sigma: Positive = Field(0.35, description="1-sigma of a track on ground of the reference texture, px")
    pixel_repeat: Positive = Field(
        40.0,
        description="Observations counted as one when the covariance of the clones is inflated: tracking errors are "
        "correlated in time and between neighbouring features",
    )
    smoother_repeat: Positive = Field(
        20.0, description="The same for the joint covariance of a smoothed flight (docs/lab/heights.md)"
    )
    texture_reference: Positive = Field(
        1.3e-3, description="Shi-Tomasi response of short grass; the sigma of a track grows as 1 / sqrt(texture)"
    )
    depth_share: Positive = Field(
        0.05, description="Relative 1-sigma of its depth below which a landmark is initialised"
    )
    vague_share: Positive = Field(
        0.2, description="Relative 1-sigma of its depth above which a feature is not used as a measurement"
    )
    clone_baseline: Positive = Field(0.02, description="Baseline over depth between clones")
    nav_position_tau: Positive = Field(60.0, description="Correlation time of the GPS/INS position error, s")
    nav_attitude_tau: Positive = Field(120.0, description="Correlation time of the GPS/INS attitude error, s")
    nav_velocity_tau: Positive = Field(20.0, description="Correlation time of the GPS/INS velocity error, s")
    nav_position_white: Positive = Field(0.05, description="1-sigma of the white part of the GPS/INS position error, m")
    nav_attitude_white: Positive = Field(
        0.002, description="1-sigma of the white part of the GPS/INS attitude error, rad"
    )
    nav_velocity_white: Positive = Field(
        0.03, description="1-sigma of the white part of the GPS/INS velocity error, m/s"
    )
    position_sigma: Positive = Field(
        5.0, description="1-sigma of the GPS/INS position where the recording states none, m"
    )
    attitude_sigma: Positive = Field(
        0.03, description="1-sigma of the GPS/INS attitude where the recording states none, rad"
    )
    velocity_sigma: Positive = Field(
        0.3, description="1-sigma of the GPS/INS velocity where the recording states none, m/s"
    )
    acceleration_sigma: Positive = Field(
        2.0, description="Noise of the constant-velocity model without an IMU, m/s^2 and rad/s^2 per sqrt(Hz)"
    )
    gyro_bias_sigma: Positive = Field(
        0.02, description="1-sigma of the gyro bias at the start, and of the angular velocity of GPS/INS, rad/s"
    )
    accelerometer_bias_sigma: Positive = Field(0.2, description="1-sigma of the accelerometer bias at the start, m/s^2")
    imu_margin: Positive = Field(
        1.25, description="Noise of the IMU in flight over the noise that its maker states for a unit at rest"
    )
    lateness: NonNegative = Field(
        1.0, description="Time by which exposures and GPS/INS rows may arrive late, s; later ones are left out"
    )
    gate: Fraction = Field(0.995, description="Probability inside the Mahalanobis gate of a measurement")
    coast: Positive = Field(2.0, description="Time without cameras and GPS after which the motion is LOST, s")
    smooth: bool = Field(True, description="Refine recorded flights with a smoother over all exposures")
    track_span: int = Field(
        15, ge=4, description="Longest track segment in the smoother, exposures; longer tracks are split"
    )


class BundleTuning(FrozenModel):
    """Constants of the bundle adjustment of photos with wide baselines."""

    features: int = Field(4000, ge=200, description="SIFT features in each photo")
    image_px: int = Field(1600, ge=400, description="Longest side of the images on which features are found, px")
    neighbours: int = Field(
        10, ge=2, description="Nearest photos with which each photo is matched, besides one in each direction"
    )
    attitude_sigma: Positive = Field(0.05, description="1-sigma of the roll and pitch of the gimbal, rad")
    heading_sigma: Positive = Field(0.15, description="1-sigma of the heading of the gimbal, rad")
    mounting_sigma: NonNegative = Field(
        0.03, description="1-sigma of the mounting of the camera on the gimbal, rad; 0: as calibrated"
    )
