"""What netconvert warns of reaches the reader of the map (SUMO 1.28)."""

from toolkit.sites.netconvert_warnings import MAX_NOTES, describe_warnings, list_warnings


def test_kinds_are_counted_and_shapes_are_dropped():
    lines = [f"Warning: Ignoring restriction relation '{k}' with unknown via." for k in range(3)]
    lines += [
        (
            "Warning: Speed of left turn connection '1_0->2_0' reduced by 3.2 due to turning "
            "radius of 4.1."
        )
    ]
    lines += [
        "Warning: 9 total messages of type: Ignoring restriction relation '%' with unknown via.",
        "Success.",
    ]
    lines += ["Warning: Edge '7' has a vertical jump of 3.5m."]
    first, second = describe_warnings(list_warnings("\n".join(lines)))
    assert first == (
        "netconvert warned: Ignoring restriction relation '0' with unknown via, and 2 more like it"
    )
    assert second == "netconvert warned: Edge '7' has a vertical jump of 3.5m"


def test_many_kinds_are_cut_and_counted():
    text = "\n".join(f"Warning: Kind {chr(97 + k)} is odd." for k in range(MAX_NOTES + 2))
    notes = describe_warnings(list_warnings(text))
    assert len(notes) == MAX_NOTES + 1
    assert notes[-1] == "netconvert warned of 2 kinds of things more"
    assert describe_warnings(list_warnings("")) == []
