"""The figures of Nishino 2009, computed on a folder of measurements, and one report of them all.

`materials` finds measurements, keeps fits and results, and computes several materials at once; `paper_figure` is what
all figures have in common; `report` writes the page. Each figure has a file of its own. Nothing here is needed to fit
or to use a model.
"""
