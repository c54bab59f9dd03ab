"""What two answers that are the same must agree on."""


def told(result, *left_out):
    """Content of a registration's JSON, without times, date, and the entries `left_out`."""
    return undated({key: value for key, value in result.to_json().items() if key not in ("seconds", *left_out)})


def undated(answer):
    """Answer, as JSON, without the date at which it was made."""
    made = {key: value for key, value in answer["provenance"].items() if key != "date"}
    return {**answer, "provenance": made}
