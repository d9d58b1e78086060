"""The dataset: its layout, reader and writer, locks, audit, splits, loading, card and exchange with other formats."""
