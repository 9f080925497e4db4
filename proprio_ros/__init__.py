"""A robot arm's sense of weight and softness from its own joints."""

__version__ = "0.1.0"
