"""modelDescription.xml: variables, units, dependencies."""
