"""Light of the wall on cells of the image: the image model of the fits and of the mode pixels."""
