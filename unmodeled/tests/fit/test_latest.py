"""What was asked for last is kept, by number or by size."""

from unmodeled.fit.running import Latest


def test_the_oldest_goes_first():
    made = []
    latest = Latest(2)
    for key in "abaca":
        assert latest.get(key, lambda key=key: made.append(key) or key * 2) == key * 2
    assert made == ["a", "b", "c"]  # a was asked for again, b went
    assert latest.find("b") is None
    assert latest.find("c") == "cc"
    assert len(latest) == 2


def test_sizes_count_and_the_last_is_kept_in_any_case():
    latest = Latest(10, len)
    latest.keep("a", "12345")
    latest.keep("b", "1234")
    latest.keep("a", "123456")  # in place of the first
    assert latest.find("b") == "1234"
    latest.keep("c", "1" * 20)
    assert [latest.find(k) for k in "abc"] == [None, None, "1" * 20]


def test_nothing_is_a_value_too():
    made = []
    latest = Latest(2)
    for _ in range(2):
        assert latest.get("a", lambda: made.append(1)) is None
    assert made == [1]
