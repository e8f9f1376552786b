"""How far the tool's own figures hold. No part of the product imports this.

nulls, nulls_draw, nulls_table     how often a mismatch is seen where there is none
evidence, evidence_page, evidence_target, evidence_reference
                                   the evidence that sets are weighed by, against sampling
follow_ups                         what tests that are asked for promise, and what they give
allowances                         what each allowance of the diagnosis costs
sbc                                simulation-based calibration of the fit
strata, strata_draw, strata_table  the same of the most probable point and its spread, in strata, and against emcee
campaigns                          the one runner of all
"""
