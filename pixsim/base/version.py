"""The version of pixsim."""

VERSION = "1.0.0"
