"""A strategy: who touches an object in the image and is as far away handles it."""

from hoid_filter.rules.strategies import ImageRule, Rule


class Touching(ImageRule):
    """The 3-D rule without the minimum interaction area."""

    def rule(self) -> Rule:
        """Return that any overlap will do, at nearly equal depth."""
        return Rule(min_share=0.0, apart_m=self.config.depth_limit_m)
