"""Parquet files before the library that reads them is asked: what a footer says (`footer`), what they take (`size`)."""
