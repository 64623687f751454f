"""Words of people: what a sentence asks for."""
