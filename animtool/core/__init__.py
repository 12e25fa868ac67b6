"""Shared base: errors, codes, units, rates, options, files and plug-ins."""
