"""`lookback compare`: methods of place recognition on pairs of drives, the paper's and others'.

drives -> descriptors or similarities -> methods (a named row each) -> answers -> scores -> report
"""
