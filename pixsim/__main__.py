"""`python -m pixsim`."""

from pixsim.cli import command

if __name__ == "__main__":
    command()
