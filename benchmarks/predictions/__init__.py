"""What an experiment will measure, written down before it; and which of that came true.

command  The commands `eyespot preregister` and `eyespot adjudicate`
plan     The plan's file, how it is made from a scene, and how a recording is compared with it
"""
