"""The command `metapp`, for `python -m metapp`."""

from metapp.cli import main

if __name__ == "__main__":
    main()
