"""The virtual bench: real device stacks without hardware, started and stopped by the tests."""
