"""`lookback eval`: the paper's comparisons on traverses of your own. `lookback dev golden`: a recording as a test.

feeds -> methods (a named row each) -> cost matrix -> answers -> metrics -> report
"""
