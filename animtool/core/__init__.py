"""What every part stands on: errors, codes, units, rates, options and plug-ins."""
