"""``python -m spinbench``; a process that is started by this one imports it again, and runs nothing."""

if __name__ == "__main__":
    from spinbench.cli import main

    main()
