"""What an experiment will measure, written down before it; and which of that came true."""
