"""The paper's comparisons on anybody's traverses: `lookback eval`.

feeds -> methods (a named row each) -> cost matrix -> answers -> metrics -> report
"""
