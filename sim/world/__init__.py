"""The street world: one seed is one route with all that stands along it, the same on every drive.

    route                      where the road runs, and through which districts
    walls, plants              procedural pictures: faces of buildings; trees, fences, ground
    solids, cars               the shapes that things are made of
    ground                     road, sidewalks, land
    sections, districts, lots  the roadside, piece by piece, and what is put there
    street                     all that stands along the route, from the world's seed alone
    traffic                    what differs between drives: parked and moving cars, which windows are lit
    light                      day, dusk, night, rain, snow: how they light a surface
    scene, sky                 shapes to Panda3D geometry with the light in it
    sensor                     what lens, exposure and noise make of a picture
    renderer                   one offscreen camera: pose in, picture out

Meters east, north and up; headings in degrees clockwise from north. "Left" is left of the outward direction.
"""

from __future__ import annotations
