"""`lookback dev paper`: the paper's comparisons on traverses of a plan.

feeds -> methods (a named row each) -> cost matrix -> answers -> metrics -> report
"""
