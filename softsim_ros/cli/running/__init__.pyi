from .nodes import NODES as NODES
from .up import (
    PAGE_PORT as PAGE_PORT,
    AlreadyUpError as AlreadyUpError,
    lock_file as lock_file,
    only_one as only_one,
)
from .web_page import (
    PageChoice as PageChoice,
    WebPage as WebPage,
)
