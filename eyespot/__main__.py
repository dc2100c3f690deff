"""`python -m eyespot`."""

from eyespot.command_line import main

main()
