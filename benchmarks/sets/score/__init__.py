"""Compares measured spots with the labels of a set: `eyespot score`.

command  The command `eyespot score`
judging  Outcome and errors of each image, their summaries by condition, and ranks of entries
pages    The whole run: tables on the terminal, CSV files, the page of a score or a leaderboard
spots    Spots of a set: read from files of ours and of others, or measured; the sample set
"""
