"""What is refined from fit to fit, whichever estimator makes them: noise, effects, walks, clocks, priors."""
