"""The version of pixsim."""

VERSION = "0.1.0"
