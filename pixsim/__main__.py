"""`python -m pixsim`."""

from pixsim.cli import main

if __name__ == "__main__":
    main()
