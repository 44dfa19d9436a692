"""The doctor before a session: looks at every device, listens to every buzzer, and says what to mend."""
