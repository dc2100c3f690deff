"""From a spot to a distance, by one of the models."""
