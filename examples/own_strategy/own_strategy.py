"""A filter strategy in a package of its own: whatever a person's box touches is handled."""

from hoid_filter.strategies.image_rules import ImageRule, Rule


class Touching(ImageRule):
    """The 3-D rule of the paper without the minimum interaction area."""

    def rule(self) -> Rule:
        """Return that any overlap is enough at nearly the same depth."""
        return Rule(min_overlap=0.0, max_depth_gap_m=self.config.depth_limit_m)
