"""Statistics of the trial: many drives of its courses, GPS that is wrong or honest, and recorded drives anew."""
