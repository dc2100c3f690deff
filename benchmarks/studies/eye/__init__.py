"""Distances through cornea, crystalline lens and the lens that the surgeon looks through.

batches     A compiled function of many items, in batches of equal size
command     The command `eyespot study eye`
errors      Errors of every recipe in many eyes behind one viewing path
figures     The figures of the report
findings    The results as data: errors by path, recipe and eccentricity
geometry    Images of spots on the retinas of many eyes
population  Eyes of a healthy adult population
recipes     What a person calibrates at the table, and the distance that follows from it
report      The report
run         The computation: all paths, all eyes, then the causes
"""
