"""Files that take their places in one step, and places that are tried before the work."""

import pytest
from refusals import refused

from cddf_jax.batch.drafts import check_folder, in_one_step


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt(), ZeroDivisionError()])
def test_nothing_is_left_of_what_was_not_completed(tmp_path, error):
    path = tmp_path / "new" / "table.csv"
    with pytest.raises(BaseException) as caught, in_one_step(path) as draft:  # noqa: PT011, PT012
        draft.write_text("half")
        raise error
    said = f"{path}: No space left on device; choose another place"
    assert str(caught.value) == said if isinstance(error, OSError) else caught.value is error
    assert not list((tmp_path / "new").iterdir())


def test_a_folder_is_tried_and_left_as_it_was(tmp_path):
    (tmp_path / "file").write_text("kept")
    check_folder(tmp_path)
    check_folder(tmp_path / "new" / "below")
    said = f"{tmp_path / 'file'}: Not a directory; choose another place"
    assert refused(check_folder, tmp_path / "file" / "a") == refused(check_folder, tmp_path / "file") == said
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("file", "kept")]
