"""The paper's methods, kept for comparison."""
