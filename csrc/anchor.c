/* Placeholder translation unit so that the law's static library links before law.c exists. */
typedef int fraclink_anchor;
