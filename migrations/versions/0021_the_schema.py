"""The schema: every table as it was when its history began anew.

Written by Alembic's comparison with `service/schema`; what comes later is a migration of its own beside this one.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0021"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Make every table."""
    op.create_table('alarm',
        sa.Column('id', sa.BigInteger().with_variant(sa.Integer(), 'sqlite'), nullable=False),
        sa.Column('kind', sa.Text(), nullable=False),
        sa.Column('scope', sa.Text(), nullable=False, comment='array, CS002 or CS002/17/X'),
        sa.Column('station', sa.Text(), nullable=True),
        sa.Column('antenna', sa.Integer(), nullable=True),
        sa.Column('dipole', sa.Text(), nullable=True),
        sa.Column('subject', sa.Text(), nullable=False, comment='tells problems of one kind and scope apart'),
        sa.Column('sentence', sa.Text(), nullable=False),
        sa.Column('content', sa.Text(), nullable=False, comment='JSON'),
        sa.Column('since_us', sa.BigInteger(), nullable=True, comment='when the problem began'),
        sa.Column('since_error_us', sa.BigInteger(), nullable=False),
        sa.Column('raised_us', sa.BigInteger(), nullable=False),
        sa.Column('seen_us', sa.BigInteger(), nullable=False, comment='when it was found last'),
        sa.Column('ended_us', sa.BigInteger(), nullable=True, comment='null while it lasts'),
        sa.Column('known_by', sa.Text(), nullable=True, comment='who acknowledged it last'),
        sa.Column('known_us', sa.BigInteger(), nullable=True),
        sa.Column('known_why', sa.Text(), nullable=True),
        sa.Column('known_until_us', sa.BigInteger(), nullable=True, comment='null is for good'),
        sa.PrimaryKeyConstraint('id', name=op.f('pk_alarm'))
    )
    op.create_index(op.f('ix_alarm_kind_scope'), 'alarm', ['kind', 'scope'], unique=False)
    op.create_table('api_key',
        sa.Column('id', sa.Integer(), nullable=False),
        sa.Column('sha256', sa.Text(), nullable=False),
        sa.Column('name', sa.Text(), nullable=True, comment='who or what uses it'),
        sa.Column('scopes', sa.Text(), nullable=False, comment='JSON'),
        sa.Column('created_us', sa.BigInteger(), nullable=False),
        sa.Column('expires_us', sa.BigInteger(), nullable=True),
        sa.Column('revoked_us', sa.BigInteger(), nullable=True),
        sa.PrimaryKeyConstraint('id', name=op.f('pk_api_key')),
        sa.UniqueConstraint('sha256', name=op.f('uq_api_key_sha256'))
    )
    op.create_table('budget',
        sa.Column('sha256', sa.Text(), nullable=False),
        sa.Column('content', sa.Text(), nullable=False, comment='canonical JSON of the terms that curves share'),
        sa.PrimaryKeyConstraint('sha256', name=op.f('pk_budget'))
    )
    op.create_table('calibration',
        sa.Column('id', sa.Text(), nullable=False, comment='SHA-256 of the inputs'),
        sa.Column('scope', sa.Text(), nullable=False, comment='array, CS002 or CS002/17/X'),
        sa.Column('station', sa.Text(), nullable=True),
        sa.Column('antenna', sa.Integer(), nullable=True),
        sa.Column('dipole', sa.Text(), nullable=True),
        sa.Column('since_us', sa.BigInteger(), nullable=False),
        sa.Column('until_us', sa.BigInteger(), nullable=False),
        sa.Column('status', sa.Text(), nullable=False),
        sa.Column('events', sa.Integer(), nullable=False),
        sa.Column('inputs', sa.Text(), nullable=False, comment='canonical JSON, hashed into id'),
        sa.Column('curves', sa.Text(), nullable=False, comment='canonical JSON, hashed into payload_sha256'),
        sa.Column('payload_sha256', sa.Text(), nullable=False),
        sa.Column('reference', sa.Text(), nullable=True, comment='the reference chains by dipole, JSON; cables and spreads by hash in chain_part'),
        sa.Column('anomalies', sa.Text(), nullable=True, comment='spectra with anomalous power: counts and the worst, JSON; null where none is'),
        sa.Column('gate', sa.Text(), nullable=True, comment='why it was not promoted; null where it passed or nobody asked'),
        sa.Column('made_us', sa.BigInteger(), nullable=False),
        sa.Column('made_by', sa.Text(), nullable=False),
        sa.Column('reason', sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint('id', name=op.f('pk_calibration'))
    )
    op.create_index('ix_calibration_gated', 'calibration', ['id'], unique=False, sqlite_where=sa.text('gate IS NOT NULL'), postgresql_where=sa.text('gate IS NOT NULL'))
    op.create_index(op.f('ix_calibration_made_us_id'), 'calibration', ['made_us', 'id'], unique=False)
    op.create_index(op.f('ix_calibration_scope'), 'calibration', ['scope'], unique=False)
    op.create_table('chain_part',
        sa.Column('sha256', sa.Text(), nullable=False),
        sa.Column('content', sa.Text(), nullable=False, comment='canonical JSON of a cable table or of the spreads of A g'),
        sa.PrimaryKeyConstraint('sha256', name=op.f('pk_chain_part'))
    )
    op.create_table('deed',
        sa.Column('by', sa.Text(), nullable=False),
        sa.Column('name', sa.Text(), nullable=False, comment='the Idempotency-Key of a request'),
        sa.Column('request_sha256', sa.Text(), nullable=False),
        sa.Column('answer', sa.Text(), nullable=True, comment='what was answered, JSON'),
        sa.Column('at_us', sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint('by', 'name', name=op.f('pk_deed'))
    )
    op.create_index(op.f('ix_deed_at_us'), 'deed', ['at_us'], unique=False)
    op.create_table('drift_report',
        sa.Column('inputs', sa.Text(), nullable=False, comment='hash of what it was made from'),
        sa.Column('report', sa.Text(), nullable=False, comment='JSON'),
        sa.Column('made_us', sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint('inputs', name=op.f('pk_drift_report'))
    )
    op.create_table('drift_source',
        sa.Column('station', sa.Text(), nullable=False),
        sa.Column('since_us', sa.BigInteger(), nullable=False, comment='the first instant of the year'),
        sa.Column('inputs', sa.Text(), nullable=False, comment='hash of all that its events were measured with but the spectra'),
        sa.Column('spectra', sa.Integer(), nullable=False, comment='count of usable spectra'),
        sa.Column('flag', sa.BigInteger(), nullable=False, comment='the last flag that was set in the year'),
        sa.Column('event', sa.BigInteger(), nullable=False, comment='the newest event'),
        sa.Column('screened', sa.Integer(), nullable=False, comment='count of usable spectra when the whole year was read last'),
        sa.PrimaryKeyConstraint('station', 'since_us', name=op.f('pk_drift_source'))
    )
    op.create_table('drift_year',
        sa.Column('station', sa.Text(), nullable=False, comment='empty for the array'),
        sa.Column('since_us', sa.BigInteger(), nullable=False, comment='the first instant of the year'),
        sa.Column('inputs', sa.Text(), nullable=False, comment='hash of its months; for the array of those of all stations'),
        sa.Column('months', sa.Text(), nullable=True, comment='JSON: what all paths together say; null where it is still to be computed'),
        sa.Column('matrix', sa.Text(), nullable=True, comment="JSON: every path beside the station's median; null for the array"),
        sa.PrimaryKeyConstraint('station', 'since_us', name=op.f('pk_drift_year'))
    )
    op.create_table('edge',
        sa.Column('station', sa.Text(), nullable=False, comment='empty for the array'),
        sa.Column('at_us', sa.BigInteger(), nullable=False, comment='where an interval begins or ends'),
        sa.Column('known_us', sa.BigInteger(), nullable=False, comment='the instant `at` of the first promotion that has it'),
        sa.PrimaryKeyConstraint('station', 'at_us', name=op.f('pk_edge')),
    comment='what follows from the ledger: between two edges every answer about a station is the same'
    )
    op.create_table('event',
        sa.Column('id', sa.BigInteger().with_variant(sa.Integer(), 'sqlite'), nullable=False),
        sa.Column('event_id', sa.Text(), nullable=False),
        sa.Column('time_us', sa.BigInteger(), nullable=False),
        sa.Column('env', sa.Text(), nullable=True, comment='covariates by name, JSON'),
        sa.Column('flag', sa.Text(), nullable=True, comment='why the event is left out of fits; its history is in event_flag'),
        sa.PrimaryKeyConstraint('id', name=op.f('pk_event')),
        sa.UniqueConstraint('event_id', name=op.f('uq_event_event_id'))
    )
    op.create_index(op.f('ix_event_time_us'), 'event', ['time_us'], unique=False)
    op.create_table('event_modes',
        sa.Column('station', sa.Text(), nullable=False),
        sa.Column('dipole', sa.Text(), nullable=False),
        sa.Column('since_us', sa.BigInteger(), nullable=False, comment='the first instant of the year'),
        sa.Column('antennas', sa.Text(), nullable=False, comment='JSON'),
        sa.Column('time_us', sa.LargeBinary(), nullable=False, comment='little-endian i8, one an event'),
        sa.Column('ln_c', sa.LargeBinary(), nullable=False, comment='little-endian f4 (antenna, event, mode)'),
        sa.Column('sha256', sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint('station', 'dipole', 'since_us', name=op.f('pk_event_modes'))
    )
    op.create_table('investigation',
        sa.Column('id', sa.Text(), nullable=False, comment='hash of the inputs'),
        sa.Column('station', sa.Text(), nullable=False),
        sa.Column('since_us', sa.BigInteger(), nullable=False),
        sa.Column('until_us', sa.BigInteger(), nullable=False),
        sa.Column('inputs', sa.Text(), nullable=False, comment='JSON'),
        sa.Column('verdict', sa.Text(), nullable=False, comment='consistent, explained or unexplained'),
        sa.Column('report', sa.Text(), nullable=False, comment='JSON, as it was made'),
        sa.Column('made_us', sa.BigInteger(), nullable=False),
        sa.Column('made_by', sa.Text(), nullable=False),
        sa.Column('reason', sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint('id', name=op.f('pk_investigation'))
    )
    op.create_index('ix_investigation_made_us', 'investigation', ['made_us', 'id'], unique=False)
    op.create_index('ix_investigation_newest', 'investigation', ['station', 'until_us', 'made_us', 'id'], unique=False)
    op.create_table('job',
        sa.Column('id', sa.BigInteger().with_variant(sa.Integer(), 'sqlite'), nullable=False),
        sa.Column('kind', sa.Text(), nullable=False),
        sa.Column('request', sa.Text(), nullable=False, comment='JSON'),
        sa.Column('reason', sa.Text(), nullable=False),
        sa.Column('by', sa.Text(), nullable=False),
        sa.Column('created_us', sa.BigInteger(), nullable=False),
        sa.Column('due_name', sa.Text(), nullable=True, comment='names scheduled work'),
        sa.Column('due_key', sa.Text(), nullable=True, comment='its name and which try it is, so that each try is enqueued once'),
        sa.Column('is_cancelled', sa.Boolean(), nullable=False),
        sa.PrimaryKeyConstraint('id', name=op.f('pk_job')),
        sa.UniqueConstraint('due_key', name=op.f('uq_job_due_key'))
    )
    op.create_index(op.f('ix_job_due_name'), 'job', ['due_name'], unique=False)
    op.create_table('kept_fit',
        sa.Column('kind', sa.Text(), nullable=False, comment='scope of its versions: array, station or antenna'),
        sa.Column('scope', sa.Text(), nullable=False, comment='whose spectra it was made from'),
        sa.Column('since_us', sa.BigInteger(), nullable=False),
        sa.Column('until_us', sa.BigInteger(), nullable=False),
        sa.Column('inputs', sa.Text(), nullable=False, comment='hash of all inputs but the spectra'),
        sa.Column('spectra', sa.Integer(), nullable=False, comment='how many usable ones it was made from'),
        sa.Column('flag', sa.BigInteger().with_variant(sa.Integer(), 'sqlite'), nullable=False, comment='the last flag set in the window'),
        sa.Column('event', sa.BigInteger().with_variant(sa.Integer(), 'sqlite'), nullable=False, comment='the newest event'),
        sa.Column('told', sa.Text(), nullable=False, comment='JSON: the pieces of the window, their versions and C'),
        sa.Column('lines', sa.LargeBinary(), nullable=False, comment='NumPy archives one after the other, one a piece'),
        sa.PrimaryKeyConstraint('kind', 'scope', 'since_us', 'until_us', name=op.f('pk_kept_fit'))
    )
    op.create_table('model',
        sa.Column('id', sa.Text(), nullable=False, comment='SHA-256 of the content'),
        sa.Column('content', sa.Text(), nullable=False, comment='canonical JSON of the adopted causes'),
        sa.PrimaryKeyConstraint('id', name=op.f('pk_model'))
    )
    op.create_table('path',
        sa.Column('id', sa.Integer(), nullable=False),
        sa.Column('station', sa.Text(), nullable=False),
        sa.Column('antenna', sa.Integer(), nullable=False),
        sa.Column('dipole', sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint('id', name=op.f('pk_path')),
        sa.UniqueConstraint('station', 'antenna', 'dipole', name=op.f('uq_path_station_antenna_dipole'))
    )
    op.create_table('process',
        sa.Column('name', sa.Text(), nullable=False, comment='host, number and a random part'),
        sa.Column('kind', sa.Text(), nullable=False, comment='api, scheduler or worker'),
        sa.Column('started_us', sa.BigInteger(), nullable=False),
        sa.Column('seen_us', sa.BigInteger(), nullable=False, comment='by the clock of the database'),
        sa.Column('inputs', sa.Text(), nullable=True, comment='hashes of what it works with: instrument, sky power, model version; JSON'),
        sa.PrimaryKeyConstraint('name', name=op.f('pk_process'))
    )
    op.create_table('receipt',
        sa.Column('sha256', sa.Text(), nullable=False, comment='of a body whose spectra are all stored'),
        sa.Column('spectra', sa.Integer(), nullable=False, comment='how many it holds'),
        sa.Column('at_us', sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint('sha256', name=op.f('pk_receipt'))
    )
    op.create_table('tag',
        sa.Column('name', sa.Text(), nullable=False),
        sa.Column('as_of_us', sa.BigInteger(), nullable=False, comment='the instant at which the ledger is frozen'),
        sa.Column('by', sa.Text(), nullable=False),
        sa.Column('reason', sa.Text(), nullable=False),
        sa.Column('at_us', sa.BigInteger(), nullable=False, comment='when it was made'),
        sa.PrimaryKeyConstraint('name', name=op.f('pk_tag'))
    )
    op.create_index(op.f('ix_tag_as_of_us'), 'tag', ['as_of_us'], unique=False)
    op.create_table('window_cut',
        sa.Column('id', sa.BigInteger().with_variant(sa.Integer(), 'sqlite'), nullable=False),
        sa.Column('station', sa.Text(), nullable=False),
        sa.Column('antenna', sa.Integer(), nullable=False),
        sa.Column('date_us', sa.BigInteger(), nullable=False, comment='when the antenna changed, as the watch found it first'),
        sa.Column('sigma_us', sa.BigInteger(), nullable=False, comment='standard deviation of the date'),
        sa.Column('made_us', sa.BigInteger(), nullable=False),
        sa.Column('lifted_us', sa.BigInteger(), nullable=True, comment='when the watch no longer found the change; null while it stands'),
        sa.PrimaryKeyConstraint('id', name=op.f('pk_window_cut'))
    )
    op.create_table('calibration_mean',
        sa.Column('calibration', sa.Text(), nullable=False),
        sa.Column('dipole', sa.Text(), nullable=False),
        sa.Column('c', sa.Float(), nullable=False, comment='mean of C over the band, V per ADC unit'),
        sa.Column('c_sigma', sa.Float(), nullable=False, comment='its standard deviation, channels fully correlated'),
        sa.ForeignKeyConstraint(['calibration'], ['calibration.id'], name=op.f('fk_calibration_mean_calibration')),
        sa.PrimaryKeyConstraint('calibration', 'dipole', name=op.f('pk_calibration_mean'))
    )
    op.create_table('cut_decision',
        sa.Column('id', sa.BigInteger().with_variant(sa.Integer(), 'sqlite'), nullable=False),
        sa.Column('cut', sa.BigInteger().with_variant(sa.Integer(), 'sqlite'), nullable=False),
        sa.Column('act', sa.Text(), nullable=False, comment='lifted or restored'),
        sa.Column('at_us', sa.BigInteger(), nullable=False),
        sa.Column('by', sa.Text(), nullable=False),
        sa.Column('reason', sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(['cut'], ['window_cut.id'], name=op.f('fk_cut_decision_cut')),
        sa.PrimaryKeyConstraint('id', name=op.f('pk_cut_decision'))
    )
    op.create_index(op.f('ix_cut_decision_cut'), 'cut_decision', ['cut'], unique=False)
    op.create_table('event_flag',
        sa.Column('id', sa.BigInteger().with_variant(sa.Integer(), 'sqlite'), nullable=False),
        sa.Column('event', sa.BigInteger().with_variant(sa.Integer(), 'sqlite'), nullable=False),
        sa.Column('flag', sa.Text(), nullable=True),
        sa.Column('reason', sa.Text(), nullable=False),
        sa.Column('by', sa.Text(), nullable=False),
        sa.Column('at_us', sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(['event'], ['event.id'], name=op.f('fk_event_flag_event')),
        sa.PrimaryKeyConstraint('id', name=op.f('pk_event_flag'))
    )
    op.create_index(op.f('ix_event_flag_event'), 'event_flag', ['event'], unique=False)
    op.create_table('examined',
        sa.Column('scope', sa.Text(), nullable=False),
        sa.Column('since_us', sa.BigInteger(), nullable=False),
        sa.Column('until_us', sa.BigInteger(), nullable=False),
        sa.Column('inputs', sa.Text(), nullable=False, comment='SHA-256 of the inputs of a fit that moved C too little to be kept'),
        sa.Column('calibration', sa.Text(), nullable=False, comment='what it confirms'),
        sa.Column('shift', sa.Float(), nullable=False, comment='largest change of C in any channel, standard deviations'),
        sa.Column('made_us', sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(['calibration'], ['calibration.id'], name=op.f('fk_examined_calibration')),
        sa.PrimaryKeyConstraint('scope', 'since_us', 'until_us', name=op.f('pk_examined'))
    )
    op.create_index(op.f('ix_examined_calibration'), 'examined', ['calibration'], unique=False)
    op.create_table('job_part',
        sa.Column('id', sa.BigInteger().with_variant(sa.Integer(), 'sqlite'), nullable=False),
        sa.Column('job', sa.BigInteger().with_variant(sa.Integer(), 'sqlite'), nullable=False),
        sa.Column('request', sa.Text(), nullable=False, comment='JSON'),
        sa.Column('inputs', sa.Text(), nullable=True, comment='hashes that the worker must have: instrument, sky power, model version; JSON'),
        sa.Column('state', sa.Text(), nullable=False, comment='queued, running, done, failed or cancelled'),
        sa.Column('worker', sa.Text(), nullable=True, comment='who holds the lease'),
        sa.Column('lease_until_us', sa.BigInteger(), nullable=True),
        sa.Column('attempts', sa.Integer(), nullable=False),
        sa.Column('result', sa.Text(), nullable=True, comment='JSON'),
        sa.Column('error', sa.Text(), nullable=True),
        sa.Column('ended_us', sa.BigInteger(), nullable=True),
        sa.ForeignKeyConstraint(['job'], ['job.id'], name=op.f('fk_job_part_job')),
        sa.PrimaryKeyConstraint('id', name=op.f('pk_job_part'))
    )
    op.create_index('ix_job_part_failed', 'job_part', ['ended_us'], unique=False, sqlite_where=sa.text("state = 'failed'"), postgresql_where=sa.text("state = 'failed'"))
    op.create_index(op.f('ix_job_part_job'), 'job_part', ['job'], unique=False)
    op.create_index('ix_job_part_open', 'job_part', ['id'], unique=False, sqlite_where=sa.text("state IN ('queued', 'running')"), postgresql_where=sa.text("state IN ('queued', 'running')"))
    op.create_index('ix_job_part_settled', 'job_part', ['ended_us'], unique=False, sqlite_where=sa.text("state IN ('done', 'cancelled')"), postgresql_where=sa.text("state IN ('done', 'cancelled')"))
    op.create_index(op.f('ix_job_part_state_id'), 'job_part', ['state', 'id'], unique=False)
    op.create_table('model_change',
        sa.Column('id', sa.BigInteger().with_variant(sa.Integer(), 'sqlite'), nullable=False),
        sa.Column('station', sa.Text(), nullable=False),
        sa.Column('act', sa.Text(), nullable=False, comment='adopted or withdrawn'),
        sa.Column('model', sa.Text(), nullable=False, comment='what the station has from now on'),
        sa.Column('before', sa.Text(), nullable=False),
        sa.Column('cause', sa.Text(), nullable=False, comment='the model that has the one cause alone'),
        sa.Column('since_us', sa.BigInteger(), nullable=True, comment='the interval in which the cause acts'),
        sa.Column('until_us', sa.BigInteger(), nullable=True),
        sa.Column('known_until_us', sa.BigInteger(), nullable=True, comment='the newest event of the investigation'),
        sa.Column('investigation', sa.Text(), nullable=True),
        sa.Column('finding', sa.Integer(), nullable=True, comment='its number in the report'),
        sa.Column('announced', sa.Text(), nullable=False, comment='change of mean C and its error by scope and dipole, JSON'),
        sa.Column('promise', sa.Text(), nullable=True, comment='gain in log-likelihood and its error, JSON'),
        sa.Column('at_us', sa.BigInteger(), nullable=False),
        sa.Column('by', sa.Text(), nullable=False),
        sa.Column('reason', sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(['before'], ['model.id'], name=op.f('fk_model_change_before')),
        sa.ForeignKeyConstraint(['cause'], ['model.id'], name=op.f('fk_model_change_cause')),
        sa.ForeignKeyConstraint(['investigation'], ['investigation.id'], name=op.f('fk_model_change_investigation')),
        sa.ForeignKeyConstraint(['model'], ['model.id'], name=op.f('fk_model_change_model')),
        sa.PrimaryKeyConstraint('id', name=op.f('pk_model_change'))
    )
    op.create_index(op.f('ix_model_change_station_id'), 'model_change', ['station', 'id'], unique=False)
    op.create_table('model_gain',
        sa.Column('cause', sa.Text(), nullable=False),
        sa.Column('since_us', sa.BigInteger(), nullable=False),
        sa.Column('until_us', sa.BigInteger(), nullable=False),
        sa.Column('station', sa.Text(), nullable=False),
        sa.Column('events', sa.Integer(), nullable=False, comment='of the window that the adoption had not seen'),
        sa.Column('gain', sa.Float(), nullable=False, comment='log-likelihood with the cause minus without'),
        sa.Column('expected', sa.Float(), nullable=False, comment='if its size is as adopted'),
        sa.Column('expected_sigma', sa.Float(), nullable=False),
        sa.Column('made_us', sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(['cause'], ['model.id'], name=op.f('fk_model_gain_cause')),
        sa.PrimaryKeyConstraint('cause', 'since_us', 'until_us', name=op.f('pk_model_gain'))
    )
    op.create_table('monthly_ratio',
        sa.Column('path', sa.Integer(), nullable=False),
        sa.Column('month_us', sa.BigInteger(), nullable=False, comment="the month's first instant"),
        sa.Column('reference', sa.Text(), nullable=False),
        sa.Column('c_ratio', sa.Float(), nullable=False, comment='band-mean C of the month over that of the reference'),
        sa.Column('c_ratio_sigma', sa.Float(), nullable=False),
        sa.Column('events', sa.Integer(), nullable=False),
        sa.Column('tilt', sa.Float(), nullable=True, comment='of ln C: coefficient of the Legendre polynomial 1 over the band'),
        sa.Column('tilt_sigma', sa.Float(), nullable=True),
        sa.Column('curvature', sa.Float(), nullable=True, comment='of ln C: coefficient of the Legendre polynomial 2'),
        sa.Column('curvature_sigma', sa.Float(), nullable=True),
        sa.ForeignKeyConstraint(['path'], ['path.id'], name=op.f('fk_monthly_ratio_path')),
        sa.ForeignKeyConstraint(['reference'], ['calibration.id'], name=op.f('fk_monthly_ratio_reference')),
        sa.PrimaryKeyConstraint('path', 'month_us', name=op.f('pk_monthly_ratio'))
    )
    op.create_table('promotion',
        sa.Column('id', sa.BigInteger().with_variant(sa.Integer(), 'sqlite'), nullable=False),
        sa.Column('scope', sa.Text(), nullable=False),
        sa.Column('station', sa.Text(), nullable=True),
        sa.Column('antenna', sa.Integer(), nullable=True),
        sa.Column('dipole', sa.Text(), nullable=True),
        sa.Column('valid_from_us', sa.BigInteger(), nullable=False),
        sa.Column('valid_to_us', sa.BigInteger(), nullable=True),
        sa.Column('calibration', sa.Text(), nullable=True),
        sa.Column('at_us', sa.BigInteger(), nullable=False),
        sa.Column('by', sa.Text(), nullable=False),
        sa.Column('reason', sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(['calibration'], ['calibration.id'], name=op.f('fk_promotion_calibration')),
        sa.PrimaryKeyConstraint('id', name=op.f('pk_promotion'))
    )
    op.create_index(op.f('ix_promotion_at_us'), 'promotion', ['at_us'], unique=False)
    op.create_index(op.f('ix_promotion_calibration'), 'promotion', ['calibration'], unique=False)
    op.create_index('ix_promotion_end', 'promotion', ['scope', 'valid_to_us'], unique=False)
    op.create_index('ix_promotion_newest', 'promotion', ['scope', 'at_us', 'id', 'valid_from_us', 'valid_to_us'], unique=False)
    op.create_index('ix_promotion_start', 'promotion', ['scope', 'valid_from_us', 'valid_to_us', 'id'], unique=False)
    op.create_index('ix_promotion_withdrawn_end', 'promotion', ['scope', 'valid_to_us'], unique=False, sqlite_where=sa.text('calibration IS NULL'), postgresql_where=sa.text('calibration IS NULL'))
    op.create_index('ix_promotion_withdrawn_start', 'promotion', ['scope', 'valid_from_us'], unique=False, sqlite_where=sa.text('calibration IS NULL'), postgresql_where=sa.text('calibration IS NULL'))
    op.create_table('spectrum',
        sa.Column('path', sa.Integer(), nullable=False),
        sa.Column('event', sa.BigInteger().with_variant(sa.Integer(), 'sqlite'), nullable=False),
        sa.Column('time_us', sa.BigInteger(), nullable=False, comment='within a minute of that of its event'),
        sa.Column('blocks', sa.Integer(), nullable=False),
        sa.Column('power', sa.LargeBinary(), nullable=False, comment='little-endian f8, one a channel, ADC^2/Ohm/MHz'),
        sa.ForeignKeyConstraint(['event'], ['event.id'], name=op.f('fk_spectrum_event')),
        sa.ForeignKeyConstraint(['path'], ['path.id'], name=op.f('fk_spectrum_path')),
        sa.PrimaryKeyConstraint('event', 'path', name=op.f('pk_spectrum'))
    )
    op.create_table('standing',
        sa.Column('scope', sa.Text(), nullable=False),
        sa.Column('valid_from_us', sa.BigInteger(), nullable=False),
        sa.Column('valid_to_us', sa.BigInteger(), nullable=False, comment='2^63 - 1 where the interval is open'),
        sa.Column('promotion', sa.BigInteger().with_variant(sa.Integer(), 'sqlite'), nullable=False, comment='the newest of the interval'),
        sa.ForeignKeyConstraint(['promotion'], ['promotion.id'], name=op.f('fk_standing_promotion')),
        sa.PrimaryKeyConstraint('scope', 'valid_from_us', 'valid_to_us', name=op.f('pk_standing')),
    comment='what follows from the ledger: the promotions that can decide as of now'
    )


def downgrade() -> None:
    """Drop every table."""
    found = sa.MetaData()
    found.reflect(op.get_bind())
    found.drop_all(op.get_bind(), [table for table in found.sorted_tables if table.name != "alembic_version"])
