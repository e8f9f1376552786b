"""The gas: moist air, and what it does in a cylinder.

air, transport   density, heat capacity, viscosity and conductivity of moist air (_air_equations, air_coefficients)
cylinder         Section 2.2 of the article: ports, phases, filling and blow-down
heat_transfer    Eq. 18-20: heat between the gas and the ambient
heat_cycle       what heat changes in a cycle
"""
