from .sweep_page import page as page
