"""The rows of scripted drivers, as they pile up."""

import gzip
import json

from scripts.study_drivers import keep


def test_a_settings_rows_replace_its_own_and_no_others(tmp_path):
    file = tmp_path / "task.jsonl.gz"
    keep([{"setting": "raw", "seed": 1}, {"setting": "CSA", "seed": 1}], file)
    first = file.read_bytes()
    keep([{"setting": "raw", "seed": 2}], file)
    found = [json.loads(line) for line in gzip.decompress(file.read_bytes()).decode().splitlines()]
    assert found == [{"setting": "raw", "seed": 2}, {"setting": "CSA", "seed": 1}]
    keep([{"setting": "raw", "seed": 1}], file)
    assert file.read_bytes() == first  # the same rows are the same file
