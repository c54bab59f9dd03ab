"""What two answers that are the same must agree on."""


def told(result, *left_out):
    """Content of a registration's JSON, without times, date, and the entries `left_out`."""
    said = {key: value for key, value in result.to_json().items() if key not in ("seconds", *left_out)}
    said["provenance"].pop("date")
    return said
