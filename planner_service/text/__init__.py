"""Sentences to token features: MiniLM by default, DistilBERT from a local folder."""
