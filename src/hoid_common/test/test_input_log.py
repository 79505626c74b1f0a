from hoid_common.inputs.input_watch import InputLog, InputWatch


class Lines:
    def __init__(self) -> None:
        self.lines: list[str] = []

    def info(self, text: str, /) -> None:
        self.lines.append(f'info: {text}')

    def warning(self, text: str, /) -> None:
        self.lines.append(f'warning: {text}')


def test_all_missing_inputs_are_one_line_which_backs_off_and_their_return_is_another() -> None:
    lines = Lines()
    log = InputLog(lines, lambda topic: topic != '/features', start_s=0.0)
    watches = [InputWatch(f'{name}s', f'/{name}', 'reliable', 0.0) for name in 'ab']
    missing = {'/a': 'no as', '/b': 'no bs', '/features': 'no features'}
    for second in range(5):
        log.update(second, watches, missing, {})
    assert lines.lines == []  # the nodes of a launch start one after the other
    for second in range(5, 50):
        log.update(second, watches, missing, {})
    assert lines.lines == ['warning: no as; no bs'] * 4  # after 5, 10, 20 and 40 s
    for watch in watches:
        watch.record_message(50.0)
    for second in range(50, 60):
        log.update(second, watches, {}, {})
    assert lines.lines[4:] == ['info: receiving as on /a, bs on /b']


def test_an_input_of_another_node_is_not_logged() -> None:
    lines = Lines()
    log = InputLog(lines, lambda _: False, start_s=0.0)
    watch = InputWatch('features', '/features', 'reliable', 0.0)
    log.update(9.0, [watch], {'/features': 'no features'}, {})
    watch.record_message(10.0)
    log.update(10.0, [watch], {}, {'clock': 'no clock'})
    assert lines.lines == ['warning: no clock']
