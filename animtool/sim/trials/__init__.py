"""One simulation in several ways: what each setting costs, and how far it is off."""
