"""The SROS 2 policy in examples/: one that sros2 can read, and what the node really has.

Its form is that of policy version 0.2.0 (sros2: policy, enclaves, enclave, profiles, profile, then
lists of topics, services and actions with their qualifiers).
"""

from __future__ import annotations

from collections.abc import Iterator
from fnmatch import fnmatch
from pathlib import Path
from xml.etree import ElementTree

import pytest
from rclpy.action import get_action_server_names_and_types_by_node
from rclpy.context import Context
from rclpy.parameter import Parameter

from epos2_ros.node.driver import DriverNode

FILE = Path(__file__).parents[2] / "examples" / "sros2_policy.xml"
QUALIFIERS = {
    "topics": ("topic", {"publish", "subscribe"}),
    "services": ("service", {"request", "reply"}),
    "actions": ("action", {"call", "execute"}),
}
COMMANDS = ("joint_trajectory", "move_to", "enable", "change_state", "home", "reset_fault")


@pytest.fixture(scope="module")
def policy() -> ElementTree.Element:
    return ElementTree.parse(FILE).getroot()


def allowed(policy: ElementTree.Element, enclave: str, kind: str, qualifier: str) -> set[str]:
    """Names in full, patterns among them."""
    (profile,) = policy.findall(f"enclaves/enclave[@path='{enclave}']/profiles/profile")
    own = f"/{profile.get('node')}/"
    return {
        (entry.text or "").replace("~/", own)
        for group in profile.findall(kind)
        if group.get(qualifier) == "ALLOW"
        for entry in group
    }


def test_it_has_the_form_that_sros2_reads(policy: ElementTree.Element) -> None:
    assert (policy.tag, policy.get("version")) == ("policy", "0.2.0")
    enclaves = policy.findall("enclaves/enclave")
    assert [e.get("path") for e in enclaves] == ["/epos2_driver", "/commander", "/observer"]
    for enclave in enclaves:
        for profile in enclave.findall("profiles/profile"):
            assert profile.get("ns") == "/"
            assert f"/{profile.get('node')}" == enclave.get("path")
            for group in profile:
                entry, qualifiers = QUALIFIERS[group.tag]
                assert set(group.attrib) <= qualifiers and len(group.attrib) == 1
                assert set(group.attrib.values()) == {"ALLOW"}
                assert len(group) and {child.tag for child in group} == {entry}


def names(found: list[tuple[str, list[str]]]) -> Iterator[str]:
    """But for what an action is made of: that is granted with the action."""
    return (name for name, _ in found if "/_action/" not in name)


@pytest.fixture
def node() -> Iterator[DriverNode]:
    context = Context()
    context.init([])
    settings = {"autostart": False, "axes.joint_1.homing.method": "here"}
    made = DriverNode(
        context=context,
        parameter_overrides=[Parameter(name, value=value) for name, value in settings.items()],
    )
    yield made
    made.destroy_node()
    context.shutdown()


def test_the_driver_may_do_all_that_it_does(
    policy: ElementTree.Element, node: DriverNode
) -> None:
    me = ("epos2_driver", "/")
    does = {
        ("topics", "publish"): set(names(node.get_publisher_names_and_types_by_node(*me))),
        ("topics", "subscribe"): set(names(node.get_subscriber_names_and_types_by_node(*me))),
        ("services", "reply"): set(names(node.get_service_names_and_types_by_node(*me))),
        ("actions", "execute"): set(
            names(get_action_server_names_and_types_by_node(node, *me))
        ),
    }
    for (kind, qualifier), found in does.items():
        granted = allowed(policy, "/epos2_driver", kind, qualifier)
        assert found <= {n for n in found if any(fnmatch(n, g) for g in granted)}
    services = allowed(policy, "/epos2_driver", "services", "reply")
    assert services - does["services", "reply"] <= {
        "/epos2_driver/home",  # with a homing method
        "/epos2_driver/query_state",  # with control_msgs
    }


def test_only_the_commander_commands(policy: ElementTree.Element) -> None:
    served = allowed(policy, "/epos2_driver", "services", "reply")
    heard = allowed(policy, "/epos2_driver", "topics", "subscribe")
    asked = allowed(policy, "/commander", "services", "request")
    told = allowed(policy, "/commander", "topics", "publish")
    assert asked <= served
    assert {f"/epos2_driver/{name}" for name in COMMANDS} <= asked | told
    assert all(any(fnmatch(t, h) for h in heard) for t in told if t.startswith("/epos2_driver/"))
    assert not allowed(policy, "/observer", "services", "request")
    told = allowed(policy, "/observer", "topics", "publish")
    assert not any(topic.startswith("/epos2") for topic in told)
