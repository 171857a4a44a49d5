"""Passes over the 3D viewport while the artist works.

viewport.py     what one viewport shows: reads the scene, makes its picture in slices; no window, no user interface
overlay.py      draws a picture over what Blender has drawn
running.py      all viewports of all windows: told by Blender of changes and redraws, gives each its slices
interface.py    where it is switched on, and what it says of itself
"""
