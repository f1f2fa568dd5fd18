"""The version of pixsim."""

VERSION = "1.1.0"
