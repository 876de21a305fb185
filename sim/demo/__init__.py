"""`lookback demo`: the main task in simulation: out by day, and home at night without GPS.

command   what is printed, and the report
story     the drive, its figures and its picture
"""
