"""Which variant of Mitsuba works on this machine: LLVM, a graphics card, or neither."""
