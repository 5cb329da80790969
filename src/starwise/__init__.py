"""starwise: satellite and satellite/inertial navigation filters with a covariance one can believe."""

__version__ = "0.1.0"
