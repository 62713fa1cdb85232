"""Steps of many axes as their blocks arrive. `pmfid serve` and the streams of a fleet share this package.

    deliveries --> order --> fleets of monitors --> rows and notices --> outlets
                                     |
                                     +--> snapshots

This package depends on no broker, web page or cluster.
"""
