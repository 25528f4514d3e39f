"""What can be known about a scene before it is simulated or fitted.

overview (its contents), forecast (stable time steps, memory, inputs over time), gradient_check with ladder
and switches (whether the gradient is that of the cost, and if not, why).
To add a line to `clothfit info`: a field in overview or forecast.
"""
