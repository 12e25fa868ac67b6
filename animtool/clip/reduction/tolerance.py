"""Default tolerances of key reduction."""

# Tolerance of keys written for samples; invisible on a person.
KEY_TOLERANCE = "0.5mm"
# Largest invisible error of a shape's weight [1].
WEIGHT_TOLERANCE = 1e-3
