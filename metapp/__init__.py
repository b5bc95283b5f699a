"""metapp: reproduce visual appearance by machine learning, and see how the way of training decides speed and quality."""

__version__ = "0.1.0"
