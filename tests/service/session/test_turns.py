"""Who gets a worker next, and who is told to come again."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest

from service.errors import BusyError, DrainingError
from service.session.turns import Quota, TurnRules, Turns

RULES = TurnRules(max_waiting=3, longest_wait_s=5.0)


def _run(play: Callable[[], Awaitable[None]]) -> None:
    asyncio.run(play())  # type: ignore[arg-type]


async def _waiting(turns: Turns[str], key: str, session: str = "") -> asyncio.Task[str]:
    task = asyncio.create_task(turns.take(key, session))
    await asyncio.sleep(0)
    return task


def test_keys_take_turns() -> None:
    """One key's queue, however long, costs another key one turn of it."""

    async def play() -> None:
        turns, served = Turns(["w"], RULES), list[str]()

        async def ask(key: str) -> None:
            worker = await turns.take(key, "")
            served.append(key)
            await asyncio.sleep(0)
            turns.give_back(worker, key)

        worker = await turns.take("greedy", "")
        asked = [asyncio.create_task(ask(key)) for key in ("greedy", "greedy", "greedy", "modest", "modest")]
        await asyncio.sleep(0)
        turns.give_back(worker, "greedy")
        await asyncio.gather(*asked)
        assert served == ["modest", "greedy", "modest", "greedy", "greedy"]

    _run(play)


def test_no_key_takes_the_last_worker_while_others_are_about() -> None:
    """Of two workers a key that is alone has both, one that is not has one."""

    async def play() -> None:
        turns = Turns(["v", "w"], RULES)
        both = [await turns.take("greedy", "") for _ in range(2)]
        for worker in both:
            turns.give_back(worker, "greedy")
        turns.give_back(await turns.take("modest", ""), "modest")
        await turns.take("greedy", "")
        second = await _waiting(turns, "greedy")
        assert not second.done()
        async with asyncio.timeout(1.0):
            await turns.take("modest", "")  # at once
        second.cancel()

    _run(play)


def test_a_session_goes_to_the_worker_that_remembers_it() -> None:
    """The state of a session need not be read again where its last worker is free."""

    async def play() -> None:
        turns = Turns(["v", "w"], RULES)
        first = await turns.take("a", "one")
        turns.give_back(first, "a")
        for _ in range(3):
            other = await turns.take("a", "two")
            turns.give_back(other, "a")
            again = await turns.take("a", "one")
            assert again == first
            turns.give_back(again, "a")

    _run(play)


def test_a_free_worker_takes_the_session_that_it_remembers_first() -> None:
    """Whoever has their state in the free worker goes first; none is overtaken for long."""

    async def served(longest_overtaken_s: float) -> list[str]:
        turns = Turns(["v", "w"], TurnRules(3, 5.0, longest_overtaken_s))
        held = {session: await turns.take("a", session) for session in ("one", "two")}
        order = list[str]()

        async def ask(session: str) -> None:
            worker = await turns.take("a", session)
            order.append(session)
            turns.give_back(worker, "a")

        asked = [asyncio.create_task(ask(session)) for session in ("one", "two")]
        await asyncio.sleep(0.02)
        turns.give_back(held["two"], "a")
        await asyncio.gather(*asked)
        turns.give_back(held["one"], "a")
        return order

    async def play() -> None:
        assert await served(longest_overtaken_s=5.0) == ["two", "one"]
        assert await served(longest_overtaken_s=0.01) == ["one", "two"]

    _run(play)


def test_as_many_wait_as_may_and_not_for_ever() -> None:
    """One more than may wait is told to come again, and so is who waited too long; nothing is lost."""

    async def play() -> None:
        turns = Turns(["w"], TurnRules(max_waiting=2, longest_wait_s=0.05))
        worker = await turns.take("a", "")
        queue = [await _waiting(turns, "a") for _ in range(2)]
        with pytest.raises(BusyError, match="2 requests of this key wait already"):
            await turns.take("a", "")
        assert turns.waiting == 3
        for task in queue:
            with pytest.raises(BusyError, match="within 0.05 s"):
                await task
        turns.give_back(worker, "a")
        assert await turns.take("a", "") == worker
        assert turns.waiting == 1

    _run(play)


def test_who_gives_up_leaves_the_worker_to_others() -> None:
    """A request that is cancelled as it is granted a worker does not keep it."""

    async def play() -> None:
        turns = Turns(["w"], RULES)
        worker = await turns.take("a", "")
        gone, next_ = await _waiting(turns, "a"), await _waiting(turns, "b")
        turns.give_back(worker, "a")
        gone.cancel()
        assert await next_ == worker

    _run(play)


def test_a_server_that_stops_sends_everyone_away() -> None:
    """Who waits and who comes are told that the server is about to stop."""

    async def play() -> None:
        turns = Turns(["w"], RULES)
        await turns.take("a", "")
        waiting = await _waiting(turns, "b")
        turns.close()
        with pytest.raises(DrainingError):
            await waiting
        with pytest.raises(DrainingError):
            await turns.take("c", "")

    _run(play)


def test_a_key_has_so_many_seconds_a_minute() -> None:
    """Beyond them it is told when to come again, which is when it may; others and this machine are not."""
    time_s = 0.0
    quota = Quota(60.0, now=lambda: time_s)
    quota.charge("a", 90.0)
    quota.charge(None, 900.0)
    with pytest.raises(BusyError, match="at most 60 s of work a minute") as caught:
        quota.check("a")
    quota.check("b")
    quota.check(None)
    assert caught.value.retry_after_s == 30
    time_s = 30.0
    quota.check("a")
