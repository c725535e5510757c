"""The virtual cell: motion, readings and poses as they would be recorded, with the truth behind them."""
