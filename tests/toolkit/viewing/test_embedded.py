from toolkit.viewing.embedded import POLICY, scene_script, script_data


def test_the_policy_asks_nobody():
    assert POLICY.startswith("default-src 'none';")
    assert "http" not in POLICY


def test_data_do_not_leave_their_script():
    data = script_data({"a": "</script><!--\u2028"})
    assert data == '{"a": "\\u003c/script>\\u003c!--\\u2028"}'


def test_the_script_may_stand_in_a_page():
    script = scene_script()
    assert script.startswith('"use strict";')
    assert "</script" not in script
