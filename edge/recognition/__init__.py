"""Recognition joins the stages up to the match: no camera, no link, no clock, and nothing of where the vehicle is.

`recognizer`         one frame in, one match out: the file to read first
`sequence_matcher`   descriptors in, matches out
`keyframe_matcher`   which frames' keypoints are compared, and with which places
`place_verification` keypoints of a picture against those of some places
`warm_start`         what is kept from one run to the next
"""
