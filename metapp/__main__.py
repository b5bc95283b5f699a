"""`python -m metapp` is the `metapp` command."""

from metapp.cli import main

if __name__ == "__main__":
    main()
