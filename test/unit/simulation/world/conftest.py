import pytest

from bullet_lab.simulation.world.sdf import read_world_file


@pytest.fixture
def read_world(tmp_path, monkeypatch):
    """Write a world with the given content, and read it with models/ as the model folder."""
    monkeypatch.setenv("GAZEBO_MODEL_PATH", str(tmp_path / "models"))

    def read(inside):
        path = tmp_path / "test.world"
        path.write_text(f'<sdf version="1.7"><world name="w">{inside}</world></sdf>')
        return read_world_file(path)

    return read


@pytest.fixture
def save_model(tmp_path):
    """Write a model of the model folder."""

    def save(name, text, config=None):
        folder = tmp_path / "models" / name
        folder.mkdir(parents=True)
        (folder / "model.sdf").write_text(text)
        if config is not None:
            (folder / "model.config").write_text(config)
        return folder

    return save
