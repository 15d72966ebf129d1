from .catalog import (
    code_folder as code_folder,
    folders_of as folders_of,
)
from .files import (
    comment as comment,
    config_file as config_file,
    config_roots as config_roots,
    file_names as file_names,
    find_config as find_config,
    installed_roots as installed_roots,
    known_scenes as known_scenes,
    named_files as named_files,
    scalar as scalar,
)
from .loaders import (
    MODULES as MODULES,
    Item as Item,
    Steps as Steps,
    laid_over as laid_over,
    load_python as load_python,
    load_scene as load_scene,
    load_yaml as load_yaml,
    override_at as override_at,
    read_overrides as read_overrides,
    write_overrides as write_overrides,
)
from .location import (
    Place as Place,
    place_of as place_of,
    places_of as places_of,
)
from .portable import (
    given_values as given_values,
    mark_source as mark_source,
    read_description as read_description,
    unstructure_scene as unstructure_scene,
    without_contents as without_contents,
    write_description as write_description,
)
from .programs import (
    ANY_PROGRAM as ANY_PROGRAM,
    XACRO as XACRO,
    ProgramRule as ProgramRule,
    allowed_program as allowed_program,
    limited_to as limited_to,
    may_hold_programs as may_hold_programs,
)
from .structure import (
    structure_description as structure_description,
    structure_scene as structure_scene,
)
from .yaml_source import (
    SourcedMapping as SourcedMapping,
    key_path as key_path,
    merge as merge,
    parse_yaml as parse_yaml,
    plain_copy as plain_copy,
    read_extended as read_extended,
    read_yaml as read_yaml,
    relative_to_file as relative_to_file,
)
