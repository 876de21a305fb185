"""Drives over one road as its layers: which of them are deleted for want of space.

`road`    which drives pass the same road, and which way they faced there
`stored`  the maps of a folder on the disk, their marks, and which are deleted when the disk's share is full
"""
