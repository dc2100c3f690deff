"""The studies: a file is one question, what is computed, its figures, its page and its command."""
