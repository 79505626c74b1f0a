"""The transport profile for a network contains the profile for one host."""

from pathlib import Path
from xml.etree import ElementTree as ET

CONFIG = Path(__file__).parents[1] / 'config'
NAMESPACE = '{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}'


def test_network_profile_contains_the_profile_of_one_host() -> None:
    one, network = (
        ET.parse(CONFIG / f'{name}.xml').getroot()  # noqa: S314 - our own
        for name in ('fastdds_profile', 'fastdds_network_profile')
    )
    rtps = network.find(f'.//{NAMESPACE}rtps')
    policy = network.find(f'.//{NAMESPACE}propertiesPolicy')
    profiles = network.find(f'{NAMESPACE}profiles')
    writer = network.find(f'.//{NAMESPACE}data_writer')
    assert rtps is not None
    assert policy is not None
    assert profiles is not None
    assert writer is not None
    size = policy.find(f'.//{NAMESPACE}value')
    assert size is not None
    assert int(size.text or '') < 1472  # Ethernet's 1500 bytes less the headers of IP and UDP
    rtps.remove(policy)
    profiles.remove(writer)

    def plain(root: ET.Element) -> list[tuple[str, str]]:
        return [(node.tag, (node.text or '').strip()) for node in root.iter()]

    assert plain(one) == plain(network)
