"""The session file: its layout, its writer, its reader. Start at FORMAT.md."""
