"""The judge of generated motion: text and motion encoders trained contrastively on the corpus, then frozen."""
