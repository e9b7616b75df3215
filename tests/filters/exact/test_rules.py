"""Gauss-Legendre rules for parts of a posterior, against closed forms."""

import math

import numpy as np
import pytest

from rangefix.filters.exact.rules import rule_for, rules
from rangefix.filters.exact.smooth_parts import NODES_WHERE_SMOOTH

ERROR = 1e-7  # relative; 2.5e-8 was measured


@pytest.mark.parametrize("light", [0.0, 3.0, 8.0, 12.0, 16.0, 25.0])
def test_rules_are_as_good_as_a_part_counts(light):
    """Exponentials and Gaussians over intervals of up to 5 e-folds or deviations, by the rule chosen."""
    rule, fewest = rules(NODES_WHERE_SMOOTH), []
    for length in np.geomspace(0.01, 5.0, 60):
        chosen = rule_for(length, light, rule.counts)
        count = rule.counts[chosen]
        nodes, weights = rule.nodes[chosen, :count], rule.weights[chosen, :count]
        fewest.append(count)
        exponential = weights @ np.exp(length * nodes) / (math.expm1(length) / length)
        gaussian = math.sqrt(math.pi / 2) / length * math.erf(length / math.sqrt(2))
        bell = weights @ np.exp(-0.5 * (length * nodes) ** 2) / gaussian
        assert max(abs(exponential - 1), abs(bell - 1)) < ERROR * math.exp(light)
    assert fewest == sorted(fewest)
    assert (fewest[-1] < 11) == (light > 8)
