"""Names that C and C++ have free: for arguments and results, and, of those, the ones that no library of C's has taken."""

from __future__ import annotations

import builtins
import keyword
import re
import sys

_WORDS = """
alignas alignof and and_eq asm auto bitand bitor bool break case catch char char8_t char16_t char32_t class co_await
co_return co_yield compl concept const const_cast consteval constexpr constinit continue decltype default delete do double
dynamic_cast else enum explicit export extern false float for friend goto if inline int long mutable namespace new noexcept
not not_eq nullptr operator or or_eq private protected public register reinterpret_cast requires restrict return short signed
sizeof static static_assert static_cast struct switch template this thread_local throw true try typedef typeid typename typeof
typeof_unqual union unsigned using virtual void volatile wchar_t while xor xor_eq linux unix i386
NULL INFINITY NAN I size_t ptrdiff_t int8_t int16_t int32_t int64_t uint8_t uint16_t uint32_t uint64_t count workspace main
"""
# C's library and, of that of POSIX, the plain words: a program that links another in their place is broken. It itself is libc.a
# and libm.a.
_MATHEMATICS = """
acos acosh asin asinh atan atan2 atanh cbrt ceil copysign cos cosh erf erfc exp exp10 exp2 expm1 fabs fdim floor fma fmax fmin
fmod frexp gamma hypot ilogb j0 j1 jn ldexp lgamma llrint llround log log10 log1p log2 logb lrint lround modf nan nearbyint
nextafter nexttoward pow remainder remquo rint round scalbln scalbn sin sincos sinh sqrt tan tanh tgamma trunc y0 y1 yn
cabs cacos cacosh carg casin casinh catan catanh ccos ccosh cexp cimag clog conj cpow cproj creal csin csinh csqrt ctan ctanh
"""
_LIBRARY = """
abort abs access accept aligned_alloc alarm asctime assert at_quick_exit atexit atof atoi atol atoll bind brk bsearch btowc
calloc chdir chmod chown clearerr clock close connect creat ctime difftime div dup environ errno execl execv exit fclose fcntl
feclearexcept fegetenv feof ferror fesetenv fetestexcept fflush ffs fgetc fgets fgetwc fileno fopen fork fprintf fputc fputs
fread free freopen fscanf fseek fsetpos fgetpos fstat ftell fwrite getc getchar getenv gets gmtime index ioctl isalnum isalpha
isatty isblank iscntrl isdigit isgraph isinf islower isnan isprint ispunct isspace isupper isxdigit kill labs ldiv link listen
llabs lldiv localtime localeconv longjmp lseek malloc mblen mbtowc memchr memcmp memcpy memmove memset mkdir mktime mmap open
pause perror pipe poll printf putc putchar putenv puts qsort quick_exit raise rand random read realloc recv remove rename
rewind rindex rmdir scanf select send setbuf setenv setjmp setlocale setvbuf shutdown signal sleep snprintf socket sprintf
srand srandom sscanf stat stderr stdin stdout strcat strchr strcmp strcoll strcpy strcspn strdup strerror strftime strlen
strncat strncmp strncpy strpbrk strrchr strspn strstr strtod strtof strtok strtol strtoll strtoul strtoull strxfrm sync system
time timegm times tmpfile tmpnam tolower toupper truncate umask uname ungetc unlink usleep utime vfprintf vprintf vsnprintf
vsprintf wait waitpid write
"""
_CMAKE = """
all clean edit_cache help install package package_source preinstall rebuild_cache test
ALL_BUILD INSTALL PACKAGE RUN_TESTS ZERO_CHECK
"""
_TARGETS = frozenset(_CMAKE.split())
_RESERVED = frozenset(_WORDS.split())  # in C, in C++, in the headers that are included, and in what is written here
_WIDTHS = {name + width for name in _MATHEMATICS.split() for width in ("", "f", "l")}
_TAKEN = frozenset(("c", "m", *_LIBRARY.split(), *_WIDTHS)) | _TARGETS


def check_word(name: str) -> None:
    """Raises `ValueError` for what is no name in C and C++, or has a meaning there."""
    if not re.fullmatch(r"(?!__|_[A-Z])[A-Za-z_][A-Za-z0-9_]*", name) or name in _RESERVED:
        raise ValueError(f"export: {name!r} is no name that C has free; write letters, digits and _, such as panda_pose")


def check_name(name: str) -> None:
    """Raises `ValueError` for what cannot be the name of a function or a library, too: one of C's library would be replaced."""
    check_word(name)
    if name in _TAKEN:
        owner = "CMake" if name in _TARGETS else "C's library"
        raise ValueError(f"export: {name!r} is taken by {owner}; choose another by name=, such as robot_{name}")


def check_library(name: str, python: bool) -> None:
    """Raises `ValueError` for what cannot be the name of a library, with which all names in it begin; and where it is to be a
    module of `python`, too, for one that would hide a module of Python's, or NumPy, and for a word of Python's: what the module
    itself needs would be lost."""
    check_name(name)
    if python and (name in sys.stdlib_module_names or name == "numpy"):
        raise ValueError(f"export: {name}.py would hide the module {name}; choose another name, such as robot_{name}")
    if python and (keyword.iskeyword(name) or name in dir(builtins) or name == "np" or name[0] == "_"):
        raise ValueError(f"export: {name!r} is a word of Python's; choose another name, such as robot_{name.lstrip('_')}")


def free_name(words: str) -> str:
    """A name for a function or a library that is like some words: a robot may be called `2dof planar` or `double`."""
    name = re.sub(r"[^a-z0-9]+", "_", words.lower()).strip("_")
    return name if re.match("[a-z]", name) and name not in _RESERVED | _TAKEN else f"robot_{name}".rstrip("_")
