from .graph import Rate as Rate
