"""What is estimated and what is assumed: parameter groups, settings, site, schedule, noise, the filter's problem."""
