"""From bytes to runs and motions in SI units: bags, published text, data sets, what a driver's topics mean, and what they show."""
