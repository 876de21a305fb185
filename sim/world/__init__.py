"""The street world: one seed is one route with all that stands along it, the same on every drive.

    route     where the road runs, and through which districts
    walls     procedural pictures of walls, plants and roads
    solids    the shapes that things are made of: boxes, gabled houses, crossed planes, cars
    sections, districts, lots   the roadside, piece by piece, and what is put there
    street    what stands along the route, from the world's seed alone
    traffic   what differs between drives: parked and moving cars, which windows are lit
    light     day, dusk, night, rain, snow: colours of the scene, and what they do to a sensor
    scene     shapes to Panda3D geometry with the light in it
    renderer  one offscreen camera: pose in, picture out

Metres east, north and up; headings in degrees clockwise from north. "Left" is left of the outward direction.
"""

from __future__ import annotations
