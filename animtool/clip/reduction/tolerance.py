"""Default tolerances of key reduction."""

# Keys written for samples stay within it: under what anyone sees on a person.
KEY_TOLERANCE = "0.5mm"
# Largest error of a shape's weight that anyone sees [1].
WEIGHT_TOLERANCE = 1e-3
