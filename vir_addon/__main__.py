"""python -m vir_addon plan | render | doctor

Everything else is imported within `main`, where Ctrl-C is waited for: importing takes most of a short command's time. What is imported
before it is part of a running interpreter.
"""

import io
import sys

LOG_WIDTH = 140
STOPPED_STATUS = 130
"""what a shell reports of a program that Ctrl-C ended"""


def main(argv: list[str] | None = None) -> int:
    """Run a command. Returns the exit status; argparse itself exits with 2 on wrong usage."""
    try:
        from .cli.interrupts import remembered_interrupts

        with remembered_interrupts():
            return _run(argv)
    except KeyboardInterrupt:
        print("vir: stopped; files that were written are whole", file=sys.stderr)
        return STOPPED_STATUS


def _run(argv: list[str] | None) -> int:
    try:
        from rich.console import Console
    except ImportError as error:
        print(f"vir: the command line needs the package rich ({error}); run: python -m pip install rich", file=sys.stderr)
        return 4
    from .cli.arguments import make_parser
    from .core.errors import DeviceError, VirError

    arguments = make_parser().parse_args(argv)
    # a name that the terminal cannot show must not end a render; without a terminal or a file there is no stream at all
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    # into a file or a farm's log there is no width to fit: keep a line a line
    console = Console(width=None if sys.stdout is not None and sys.stdout.isatty() else LOG_WIDTH)
    try:
        if arguments.command == "doctor":
            from .cli.doctor import run_doctor

            run_doctor(console)
        else:
            try:
                from .cli.commands import run_plan, run_render
            except ModuleNotFoundError as error:
                raise DeviceError(f"a package is missing ({error}); python -m vir_addon doctor says what to install") from error

            (run_plan if arguments.command == "plan" else run_render)(arguments, console)
    except VirError as error:
        errors = Console(stderr=True)
        errors.print(f"vir: {error}", style="red", highlight=False, markup=False, soft_wrap=True)
        return error.exit_status
    return 0


if __name__ == "__main__":
    sys.exit(main())
