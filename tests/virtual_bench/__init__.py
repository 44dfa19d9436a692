"""The real stacks without the hardware: sound servers, pictures and boards that the tests start and stop themselves."""
