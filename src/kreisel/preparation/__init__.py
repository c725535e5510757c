"""From a recording to the filter's problem: noise, standstill, start values, checks of plausibility."""
