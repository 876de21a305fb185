"""The place belief measured on other roads, and what each claim is worth."""
