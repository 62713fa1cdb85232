"""The monitor as a service, which watches many axes as their data arrive, keeps its state and gives out estimates.

    sources --> deliveries --> order --> fleets of monitors --> rows and notices --> sinks, board --> page
                                            |
                                            +--> checkpoints --> deliveries are acknowledged

The engine's thread owns all estimators. Sources hand deliveries over through a bounded inbox, and wait while the inbox
is full. The engine offers outcomes to outlets, which never make the engine wait. Each outlet has a bounded queue, and
counts the outcomes that the queue drops.
"""
