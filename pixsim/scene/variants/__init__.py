"""Which variant of Mitsuba works on this machine: what may abort is tried in a process of its own (`trial`, `checks`)."""
