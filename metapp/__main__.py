"""The command `metapp` for those who start it by `python -m metapp`. Its code is in `metapp.cli`."""

from metapp.cli import main

if __name__ == "__main__":
    main()
