"""metapp: reproduce visual appearance by machine learning; see how the way of training decides speed and quality."""

__version__ = "0.1.0"
