"""`lookback model`: from published weights to the int8 network of a vehicle, at a desk."""
