"""How far an indoor position estimate can be trusted: claimed against true covariance of localisation filters."""

__version__ = "0.1.0"
