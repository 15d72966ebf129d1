from .nodes import NODES as NODES
from .one_at_a_time import (
    AlreadyUpError as AlreadyUpError,
    lock_file as lock_file,
    only_one as only_one,
)
from .up import PAGE_PORT as PAGE_PORT
from .web_page import (
    PageChoice as PageChoice,
    WebPage as WebPage,
)
