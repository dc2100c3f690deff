"""Distances through cornea, crystalline lens and the lens that the surgeon looks through.

command     The command `eyespot study eye`
errors      Errors of every recipe in many eyes behind one viewing path
geometry    Images of spots on the retinas of many eyes, in batches
population  Eyes of a healthy adult population
recipes     What a person calibrates at the table, and the distance that follows from it
run         The study: all paths, all eyes, the causes; tables, figures, page
"""
