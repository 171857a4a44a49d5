"""What is timed. Run with `make bench`; nothing here is a test, because times depend on the machine and on what else it does."""
