"""Names that people and other detectors give to the classes of COCO."""

from __future__ import annotations

# The first name of each group is COCO's name. A word may be in several groups.
_GROUPS = (
    ('couch', 'sofa', 'settee'),
    ('chair', 'armchair', 'stool', 'seat'),
    ('dining table', 'table', 'desk', 'diningtable'),
    ('tv', 'television', 'monitor', 'screen', 'display', 'tvmonitor'),
    ('laptop', 'notebook', 'computer'),
    ('mouse', 'computer mouse'),
    ('remote', 'remote control'),
    ('cell phone', 'phone', 'mobile', 'mobile phone', 'smartphone', 'cellphone'),
    ('cup', 'mug', 'coffee cup'),
    ('wine glass', 'glass'),
    ('potted plant', 'plant', 'houseplant', 'pottedplant'),
    ('refrigerator', 'fridge'),
    ('oven', 'stove', 'cooker'),
    ('sink', 'washbasin', 'basin'),
    ('toilet', 'wc'),
    ('backpack', 'rucksack', 'bag'),
    ('handbag', 'purse', 'bag'),
    ('suitcase', 'luggage', 'bag'),
    ('teddy bear', 'teddy'),
    ('sports ball', 'ball'),
    ('bicycle', 'bike'),
    ('motorcycle', 'motorbike'),
    ('airplane', 'aeroplane', 'plane'),
    ('hair drier', 'hair dryer', 'hairdryer'),
    ('donut', 'doughnut'),
)
_PLURALS = ('', 's', 'es')


def class_names(word: str) -> frozenset[str]:
    """Return the word, and all names of the classes that it may mean: "sofas" may mean "couch"."""
    stems = [word.removesuffix(ending) for ending in _PLURALS]
    groups = [group for group in _GROUPS if any(stem in group for stem in stems)]
    return frozenset([*stems, *(name for group in groups for name in group)])
