"""Parameters of nodes, under the name that they had; see `bullet_lab.core.parameters`."""

from bullet_lab.core.parameters import (  # noqa: F401
    ParameterError,
    boolean,
    checked,
    choice,
    integer,
    mapping,
    name_list,
    number,
    number_list,
    odd,
    read_parameters,
    text,
)
