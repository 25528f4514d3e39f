"""What can be said of a scene before it is simulated or fitted.

overview (what is in it), forecast (how long a step may be, how much memory), gradient_check with ladder and contacts
(whether the gradient is that of the cost, and where it is not, why).
To add a line to `clothfit info`: a field in overview or forecast.
"""
