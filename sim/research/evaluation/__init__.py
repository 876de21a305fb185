"""The place belief measured: on other roads, at any spacing, by light, and what each claim is worth."""
