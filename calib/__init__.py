"""Session file in, microphone positions out."""
